"""The regressor as a process: its node, and the weights that it is given while it runs."""
