"""Mesh files: OFF and VEG natively, everything else through meshio."""
