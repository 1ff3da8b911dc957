"""What `import tuberline` gives, by subject: weighing, recordings, runs. Users import it from `tuberline` itself."""
