"""Transfer functions B(s)/A(s): models, predictions and gates. Nothing here estimates."""
