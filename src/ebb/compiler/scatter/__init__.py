"""Reductions into other rows, in parallel and with the same bits for any number of threads."""
