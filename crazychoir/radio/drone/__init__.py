"""A Crazyflie behind a radio link, as the agent sees it."""
