"""The whole way of a grasp: approach, pregrasp, grasp, squeeze and lift, checked for what is in the way, and timed."""
