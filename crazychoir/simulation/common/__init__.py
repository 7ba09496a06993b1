"""Parts that all simulated worlds share: contract, true states, random draws and links."""
