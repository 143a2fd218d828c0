"""Tests for residuals beyond noise, and scores of effects that might explain them."""
