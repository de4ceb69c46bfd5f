"""Derivatives of witness points, and the differentiable layer over them."""
