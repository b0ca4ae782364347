"""A campaign in a folder that stays consistent if its writer is killed."""
