"""What is wrong with a model, from a recorded run or before one."""
