"""Parts of `acceptance/attack.py`: inputs, mutations, cases, and running a case."""
