"""From the records of messages to pixels."""
