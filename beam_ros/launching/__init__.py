"""Starting, watching and ending the rig's nodes as processes of the operating system."""
