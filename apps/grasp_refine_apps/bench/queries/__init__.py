"""What a witness query costs, forward and backward, against named peers; and what is saved by what is not done."""
