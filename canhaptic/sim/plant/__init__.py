"""Motor, effects and hand as one hybrid plant, exact between two torques."""
