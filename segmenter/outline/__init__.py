"""How far a camera's outlines are off: the load itself tells, for each tuber is seen from two sides on its way."""
