"""A scene touched by a pointer: twice at the same time, unprotected and protected, in real time behind a page."""
