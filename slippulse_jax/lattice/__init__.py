"""The discrete model: blocks, springs and contacts that break one by one."""
