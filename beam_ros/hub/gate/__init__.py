"""What may reach the axis: every set-point and every sequence is checked here, whatever the link behind it."""
