"""The ledger on disk: written once, checked, read, repaired, exported."""
