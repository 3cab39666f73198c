"""A recorded run as pandas tables: reading thousands of messages at once, names and units of the columns."""
