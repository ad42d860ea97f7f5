"""One simulated effect a file, and the table that names them."""
