"""The onboard planner's twin: table images, and Algorithm 1 with the same bits as the C."""
