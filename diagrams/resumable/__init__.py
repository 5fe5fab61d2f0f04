"""Long runs of studies: many draws in several processes, kept in a file as they are done."""
