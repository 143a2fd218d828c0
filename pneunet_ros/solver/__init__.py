"""The rod's boundary value problem as compiled kernels: equations of a panel, Newton, stations, sensitivities."""
