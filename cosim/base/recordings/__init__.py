"""Recordings in files: CSV and Parquet, their columns and their times."""
