"""Each estimator against each fault of its data: an error, a warning that names the cause, or the right answer."""
