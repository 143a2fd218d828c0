"""What a reading means, what noise moves, what covariance follows: y = h(x) + e."""
