"""Witness queries: signed distances and witness points of pairs of bodies."""
