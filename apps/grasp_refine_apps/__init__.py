"""The application: command line, batches, viewer, benchmarks and reports."""
