"""Effects that model files state: exact terms of their formats, which no diagnosis proposes."""
