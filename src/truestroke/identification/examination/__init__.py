"""What a record holds, and what is wrong with it, before anything is fitted."""
