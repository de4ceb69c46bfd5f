"""Server of the page, the rules for requests to it, and the private parts of viser."""
