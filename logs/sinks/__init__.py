"""Where tracked lines can be written."""
