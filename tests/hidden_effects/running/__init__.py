"""Sessions of the finite-element plant in which something happens to the axis, and what the product makes of them."""
