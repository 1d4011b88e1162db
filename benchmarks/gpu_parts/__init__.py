"""Parts of the benchmark `gpu`: what each measures, its process, and the page of the results."""
