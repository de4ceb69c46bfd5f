"""Batches of any number of grasps: shards, the processes or the cluster that work on them, and their reports."""
