def plot(results): return []
