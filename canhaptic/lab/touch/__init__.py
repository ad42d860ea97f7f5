"""`canhaptic touch`: a scene simulated twice in real time, unprotected and protected, held by the pointer on a page."""
