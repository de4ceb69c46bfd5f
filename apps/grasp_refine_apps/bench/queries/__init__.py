"""Cost of a witness query, forward and backward, against named peers; and the savings of skipped work."""
