"""Which stages a substep has, and which method, substeps and iterations an object is given."""
