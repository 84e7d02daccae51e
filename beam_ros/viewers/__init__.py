"""Files with which PlotJuggler, Foxglove, Lichtblick, RViz and ``ros2 bag`` know the rig, made from the topic table."""
