"""The robot and the log that `geodrake demo` explains; README.md says how they were made."""
