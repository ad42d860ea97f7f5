"""What a hand feels of a wall: the stiffness that is held, how deep a slow hand goes, entry, drag and sticking."""
