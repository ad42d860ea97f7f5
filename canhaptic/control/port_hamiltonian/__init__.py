"""Port-Hamiltonian networks: storages, dissipators, their samples, and the virtual objects made of them."""
