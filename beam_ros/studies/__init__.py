"""Many bags, or many simulated experiments: one row each, on workers that may die, with a page that sums them up."""
