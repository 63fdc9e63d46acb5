"""The networks: blocks, one small file per network, and the table of builders."""
