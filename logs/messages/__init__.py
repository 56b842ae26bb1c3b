"""What messages of logs say, whatever format they are in."""
