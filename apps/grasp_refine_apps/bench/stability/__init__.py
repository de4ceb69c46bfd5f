"""How often a witness query, or its derivative, is wrong: bodies of all sizes in all states, against a reference."""
