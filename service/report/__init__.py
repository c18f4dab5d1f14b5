"""Turn records into what people read: reports of explanations in Markdown and HTML, and charts in SVG."""
