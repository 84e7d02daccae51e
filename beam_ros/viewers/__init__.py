"""Files for PlotJuggler, Foxglove, Lichtblick, RViz and ``ros2 bag``, made from the topic table."""
