"""What `acceptance/attack.py` is made of: inputs, mutations, cases, and how one is run."""
