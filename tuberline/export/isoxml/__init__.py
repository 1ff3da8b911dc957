"""ISO 11783-10 (ISOXML): a day's yield as TASKDATA with a time log, and time logs of other terminals read."""
