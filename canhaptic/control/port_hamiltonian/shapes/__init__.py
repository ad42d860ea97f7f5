"""Virtual objects in task space, each a port-Hamiltonian network."""
