"""A far side behind a port: what arrives is a local model and a total of energy, never a torque.

The far side is a rig behind a network or a slow world. `port` renders the model under a rule of energy, `packet` and
`session` carry and prove what arrives, `udp` sends it, `side` joins them for the cycle; `parameters` are its keys.
"""
