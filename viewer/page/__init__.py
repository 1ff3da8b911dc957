"""The operator's page: a line as numbers and plain words in a browser. It observes; nothing waits for it."""
