"""Work in processes: tasks go to the workers of this machine or of a cluster, and lost ones are tried again."""
