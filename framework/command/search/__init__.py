"""`fishersplat search`: options chosen on training views that were held out."""
