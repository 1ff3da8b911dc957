"""Alarms that leave the page: what is wrong with a line is sent once when it begins and once when it ends."""
