"""The source of step functions: syntax trees, removal of records, and generated functions."""
