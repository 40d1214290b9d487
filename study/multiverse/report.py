def pages(multiverse): return {}
