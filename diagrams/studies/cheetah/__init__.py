"""A leg like the MIT Cheetah 3's: what the studies of it share."""
