"""Tools of all layers: late imports, files, random states, threads, settings, the jackknife."""
