"""From tracks to tubers: fusion, merging of cameras, the ledger, totals, score and audit."""
