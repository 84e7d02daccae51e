"""Any sensor in any bag: fields by their path, how they are described, and what they become for identification."""
