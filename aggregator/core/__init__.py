"""The pure part: entries in, tubers out; merging, fusion, totals, coverage."""
