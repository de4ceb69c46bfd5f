"""The panels of the page: widgets that call commands of the controller and show its state."""
