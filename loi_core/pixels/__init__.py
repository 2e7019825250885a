"""What happens to pixels before the method sees them: layout, pixels that are not finite, tone curve, bounds."""
