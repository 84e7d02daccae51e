"""What the rooms agree on: the graph of nodes and topics, and the table of the rig's parameters."""
