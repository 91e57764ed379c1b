"""Taylor integration and compiled functions by heyoka."""
