"""Tuber or not: averaged top views of tracks, the classifier, and what the load itself teaches."""
