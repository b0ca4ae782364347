"""What blocks and diagrams become in python-control."""
