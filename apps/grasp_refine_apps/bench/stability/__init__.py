"""Error rate of a witness query, or its derivative: bodies of all sizes in all states, against a reference."""
