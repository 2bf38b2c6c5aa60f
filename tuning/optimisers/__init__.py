"""Adam, L-BFGS and Levenberg-Marquardt as (init, update)."""
