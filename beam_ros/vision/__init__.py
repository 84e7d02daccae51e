"""The camera as an instrument. Pure: NumPy and OpenCV only; nothing here imports rclpy.

What needs OpenCV is imported from its own module, so that parameters, timing and calibration are there without it.
"""
