"""Modal models: structure, parameters, realisations and responses. Nothing here estimates."""
