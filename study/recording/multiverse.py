def record_multiverse(path, m, p): pass
