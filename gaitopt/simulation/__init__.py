"""The forward hybrid simulator, which chooses the contact modes by itself, on scipy or heyoka."""
