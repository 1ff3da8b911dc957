"""A day's report for a person: HTML in one file, and PDF."""
