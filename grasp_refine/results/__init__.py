"""Results of refinements: measures, tables, result files and JSON documents."""
