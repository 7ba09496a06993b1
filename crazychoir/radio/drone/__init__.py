"""A Crazyflie behind a radio link, as the flight sees it."""
