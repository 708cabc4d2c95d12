"""What a report is made of: blocks of a document, charts, grids of pictures, colours."""
