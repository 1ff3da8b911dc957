"""A fleet's ledgers in one PostgreSQL: committed tubers and loads of any number of lines."""
