"""Parts of reports: console, progress, tables of hands, charts and HTML."""
