"""A campaign in a folder, whole whatever happens to its writer."""
