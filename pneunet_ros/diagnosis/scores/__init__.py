"""Whether a fit leaves more than noise, and which effects might explain it."""
