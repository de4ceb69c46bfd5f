"""Export of grasps to the programs that use them: a folder each, which they take unedited."""
