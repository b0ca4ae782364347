"""Sentences on a wrong model, and on faulty sensors that look like one."""
