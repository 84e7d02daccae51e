"""What the rooms agree on: the graph of nodes and topics, and the schema of the parameters."""
