"""Pictures that teach the method, drawn from what the product itself computes."""
