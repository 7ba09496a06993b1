"""What all simulated worlds share: the contract, true states, random draws and links."""
