"""Parts that the distributed algorithms share: messages, mixing, step sizes and stopping."""
