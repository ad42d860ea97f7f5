"""Port-Hamiltonian networks: storages, discrete gradient, Newton's method, and the shapes made of them."""
