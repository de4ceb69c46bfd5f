"""The alignment task of arXiv 2511.06267: move a body until the witness points of two lie on their targets."""
