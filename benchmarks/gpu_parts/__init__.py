"""Parts of the benchmark `gpu`: what each does, their processes, and the page of their results."""
