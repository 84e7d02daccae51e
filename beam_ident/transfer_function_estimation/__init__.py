"""Transfer functions from records: SRIVC, RIVC, CLSRIVC, output error, order selection."""
