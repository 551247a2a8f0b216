"""The planner in Python: it searches a table for the next action, with the same bits as the C."""
