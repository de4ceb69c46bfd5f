"""What is told about refined grasps: tables for people, JSON and result files for programs."""
