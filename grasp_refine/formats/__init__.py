"""Grasp files of others: read without running what is in them, matched to our hands by joint name, and written."""
