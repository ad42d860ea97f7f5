"""An attack on the certificates: a plant of its own, and hands that climb to where energy comes out."""
