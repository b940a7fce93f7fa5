"""What runs come to: states, times and what follows from them; files of them."""
